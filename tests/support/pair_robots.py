"""One small robot as a URDF and as an independent MJCF with other frames, bodies and order."""

URDF = """\
<robot name="pair">
  <link name="base"/>
  <link name="arm"><inertial><origin xyz="0.05 -0.02 0.1" rpy="0.3 -0.8 2"/><mass value="0.7"/>
    <inertia ixx="2e-3" ixy="1e-4" ixz="-2e-4" iyy="3e-3" iyz="3e-4" izz="4e-3"/></inertial></link>
  <link name="weight"><inertial><origin xyz="0.01 0 0.02"/><mass value="0.2"/>
    <inertia ixx="1e-4" ixy="0" ixz="0" iyy="2e-4" iyz="0" izz="2e-4"/></inertial></link>
  <link name="jaw"><inertial><origin xyz="0 0.03 0.01"/><mass value="0.3"/>
    <inertia ixx="5e-4" ixy="0" ixz="1e-5" iyy="4e-4" iyz="0" izz="3e-4"/></inertial></link>
  <link name="whip"><inertial><origin xyz="0.1 0 0.01"/><mass value="0.4"/>
    <inertia ixx="2e-4" ixy="0" ixz="1e-5" iyy="9e-4" iyz="0" izz="8e-4"/></inertial></link>
  <joint name="lift" type="revolute"><origin xyz="0.1 0.2 0.3" rpy="0.4 -1.1 2.5"/>
    <parent link="base"/><child link="arm"/><axis xyz="0.6 0 0.8"/>
    <limit lower="-0.8" upper="1.1" effort="5" velocity="1"/><dynamics damping="0.3"/></joint>
  <joint name="weld" type="fixed"><origin xyz="0 0.02 0.05" rpy="0 0.2 0"/>
    <parent link="arm"/><child link="weight"/></joint>
  <joint name="slide" type="prismatic"><origin xyz="0 0.1 0.1" rpy="0.5 0 0"/>
    <parent link="arm"/><child link="jaw"/><axis xyz="0 1 0"/>
    <limit lower="-0.1" upper="0.2" effort="7" velocity="1"/><dynamics damping="2"/></joint>
  <joint name="swing" type="revolute"><origin xyz="0 0 0.25" rpy="0 0.3 0"/>
    <parent link="weight"/><child link="whip"/><axis xyz="0 0.8 0.6"/>
    <limit lower="-1" upper="1.5" effort="3" velocity="1"/><dynamics damping="0.1"/></joint>
  <softdyn version="1"><joint name="swing" armature="0.004"/><joint name="lift" armature="0.01"/>
    <tendon name="cable"><site link="base" xyz="0 0 0.5"/><site link="arm" xyz="0.05 0 0.1"/>
      <site link="whip" xyz="0.1 0 0"/></tendon>
    <actuator name="pull" tendon="cable" gear="-2" lower="0" upper="3"/>
  </softdyn>
</robot>
"""

# Every body's frame lies on its joint with the axes of the base; the weld is a part of the arm.
MJCF = """\
<mujoco model="pair">
  <compiler angle="radian"/>
  <worldbody>
    <site name="cable_0" pos="0 0 0.5"/>
    <body name="upper" pos="0.1 0.2 0.3">
      <joint name="lift" axis="0.494506493074041 0.0194550794153553 0.868956171617738"
        range="-0.8 1.1" damping="0.3"
        armature="0.01" actuatorfrcrange="-5 5"/>
      <inertial pos="0.0704490659522372 0.00525685574292881 0.0741955521157819" mass="0.9"
        fullinertia="0.00378049975412181 0.00334463881425257 0.003607213278282
          0.000708321173651726 4.54666182405703e-05 0.000304429869236866"/>
      <site name="cable_1" pos="0.070898202552179 -0.00435473115675067 0.0863393374506813"/>
      <body name="whip" pos="0.239252677658722 -0.0583196187489984 0.171051579203859">
        <joint name="swing" axis="0.145902002967603 -0.772794065681379 0.617658431155672"
        range="-1 1.5" damping="0.1"
        armature="0.004" actuatorfrcrange="-3 3"/>
        <inertial pos="-0.0685181942690339 0.0321465312199653 0.0661200240822304" mass="0.4"
        fullinertia="0.00046455958596704 0.000826183203730588 0.000609257210302371
          0.000173094920699779 0.000253177751911287 -0.000127455296838409"/>
        <site name="cable_2" pos="-0.0745924337726051 0.0324183871898231 0.0581808988920783"/>
      </body>
      <body name="jaw" pos="0.0617489384821931 -0.112488301760329 0.0594428344159277">
        <joint name="slide" type="slide"
        axis="0.187267480931783 -0.915796275308236 0.35531404801531"
        range="-0.1 0.2" damping="2"
        armature="0" actuatorfrcrange="-7 7"/>
        <inertial pos="0.0147442202498748 -0.0245137509390514 0.0134790201469298" mass="0.3"
        fullinertia="0.000323285349215416 0.000400214037548094 0.00047650061323649
          -3.54779610277299e-05 -5.10095935214878e-05 1.92502469794976e-05"/>
      </body>
    </body>
  </worldbody>
  <tendon>
    <spatial name="cable">
      <site site="cable_0"/><site site="cable_1"/><site site="cable_2"/></spatial>
  </tendon>
  <actuator>
    <motor name="pull" tendon="cable" gear="-2" ctrlrange="0 3" ctrllimited="true"/>
  </actuator>
</mujoco>
"""
