"""The fields of a compiled MuJoCo model: read, without effect, or reported.

A comparison reads the fields of `READ`. Those of `WITHOUT_EFFECT` change no motion, for the reason
that is given there. Any other field that is not at MuJoCo's default is reported by its name. So no
field is ignored silently, not even a new one of a later MuJoCo.
"""

from __future__ import annotations

from fnmatch import fnmatchcase
from functools import cache

import mujoco
import numpy as np

Numbers = tuple[float, ...]


def _names(text: str) -> tuple[str, ...]:
    return tuple(text.split())


READ = _names("""
    qpos0 qpos_spring body_parentid body_jntnum body_jntadr body_pos body_quat body_ipos body_iquat
    body_mass body_inertia body_gravcomp jnt_type jnt_qposadr jnt_dofadr jnt_bodyid jnt_pos jnt_axis
    jnt_stiffness jnt_stiffnesspoly jnt_range jnt_limited jnt_actfrclimited dof_bodyid dof_jntid
    dof_armature dof_damping dof_dampingpoly dof_frictionloss site_bodyid site_pos site_quat
    geom_bodyid tendon_type tendon_adr tendon_num tendon_stiffness tendon_stiffnesspoly
    tendon_damping tendon_dampingpoly tendon_armature tendon_lengthspring tendon_limited
    tendon_actfrclimited wrap_type wrap_objid wrap_prm actuator_trntype actuator_trnid actuator_gear
    actuator_ctrlrange actuator_ctrllimited actuator_ctrladr actuator_ctrlnum actuator_outadr
    actuator_outnum actuator_group actuator_armature actuator_damping actuator_dampingpoly
    actuator_forcelimited actuator_actlimited eq_type eq_obj1id eq_obj2id eq_objtype eq_data
    eq_active0 opt.gravity opt.disableactuator mjDSBL_GRAVITY
""")

# Reason → patterns for `fnmatch`; no * where a field of a later MuJoCo could have an effect.
WITHOUT_EFFECT = {
    "names, text and states": _names("""
        name_* names names_map paths signature *_user numeric_* text_* tuple_* key_*
    """),
    "appearance": _names("""
        vis cam_* light_* mat_* tex_* skin_* *_rgba *_matid geom_group site_group jnt_group
        tendon_group tendon_width site_type site_size site_dataid geom_castshadow
    """),
    "sensors": _names("sensor_* opt.magnetic mjDSBL_SENSOR"),
    "contacts, which are not compared": _names("""
        mesh_* hfield_* bvh_* oct_* pair_* exclude_* body_bvhadr body_bvhnum body_margin
        body_contype body_conaffinity geom_contype geom_conaffinity geom_condim geom_dataid
        geom_priority geom_solmix geom_solref geom_solimp geom_aabb geom_rbound geom_friction
        geom_margin geom_gap geom_surfacevel geom_adhesion flg_surfacevel flg_adhesion opt.impratio
        opt.cone opt.o_margin opt.o_solref opt.o_solimp opt.o_friction opt.ccd_tolerance
        opt.ccd_iterations opt.sdf_initpoints opt.sdf_iterations mjDSBL_CONTACT mjDSBL_FILTERPARENT
        mjDSBL_MIDPHASE mjDSBL_NATIVECCD mjDSBL_MULTICCD mjENBL_OVERRIDE mjENBL_SPECULATIVE
        mjENBL_IPC
    """),
    "refused: flexible bodies and plugins": _names("""
        flex_* flexedge_* efm0_* efmC_* plugin plugin_* *_plugin
    """),
    "accuracy and speed of the computation": _names("""
        opt.timestep opt.integrator opt.solver opt.jacobian opt.tolerance opt.ls_tolerance
        opt.noslip_tolerance opt.iterations opt.ls_iterations stat mjDSBL_WARMSTART mjDSBL_EULERDAMP
        mjDSBL_ISLAND mjDSBL_AUTORESET mjENBL_ENERGY mjENBL_FWDINV mjENBL_INVDISCRETE
    """),
    "computed by the compiler from other fields": _names("""
        body_rootid body_weldid body_dofnum body_dofadr body_treeid body_geomnum body_geomadr
        body_simple body_sameframe body_subtreemass body_invweight0 jnt_actuatorid jnt_plasticadr
        dof_parentid dof_treeid dof_Madr dof_simplenum dof_invweight0 dof_M0 dof_length tree_bodyadr
        tree_bodynum tree_dofadr tree_dofnum geom_sameframe site_sameframe tendon_actuatorid
        tendon_plasticadr tendon_treenum tendon_treeid tendon_length0 tendon_invweight0 ten_J_*
        actuator_actadr actuator_actnum actuator_historyadr actuator_acc0 actuator_length0
        flg_gravcomp B_* M_* D_* mapM2M mapM2D mapD2M
    """),
    "reported flag by flag": _names("opt.disableflags opt.enableflags"),
}

# Fields → fields; the former act only if one of the latter is on.
SWITCHES = {
    name: _names(switches)
    for names, switches in (
        ("jnt_solref jnt_solimp jnt_margin", "jnt_limited"),
        ("jnt_actfrcrange", "jnt_actfrclimited"),
        ("jnt_actgravcomp", "flg_gravcomp"),
        ("jnt_springyield", "jnt_stiffness jnt_stiffnesspoly"),
        ("dof_solref dof_solimp", "dof_frictionloss"),
        ("tree_sleep_policy opt.sleep_tolerance", "mjENBL_SLEEP"),
        ("tendon_range tendon_margin tendon_solref_lim tendon_solimp_lim", "tendon_limited"),
        ("tendon_solref_fri tendon_solimp_fri", "tendon_frictionloss"),
        ("tendon_actfrcrange", "tendon_actfrclimited"),
        ("tendon_springyield", "tendon_stiffness tendon_stiffnesspoly"),
        ("actuator_forcerange", "actuator_forcelimited"),
        ("actuator_actrange", "actuator_actlimited"),
        ("actuator_dynprm actuator_actearly", "actuator_dyntype"),
        ("actuator_biasprm", "actuator_biastype"),
        ("actuator_lengthrange actuator_ctrlspec", "actuator_gaintype"),
        ("actuator_history", "actuator_delay"),
        ("eq_solref eq_solimp", "eq_active0"),
        ("geom_fluid opt.wind", "opt.density opt.viscosity"),
        ("geom_type geom_size geom_pos geom_quat", "geom_fluid"),
    )
    for name in _names(names)
}

# Fields with a row per input or output of an actuator: the first row, and their number.
INPUTS, OUTPUTS = _names("ctrlrange ctrllimited"), _names("gear lengthrange acc0 length0")
COUNTED = {f"actuator_{name}": ("actuator_ctrladr", "actuator_ctrlnum") for name in INPUTS} | {
    f"actuator_{name}": ("actuator_outadr", "actuator_outnum") for name in OUTPUTS
}
ONE_OF_EACH = """<mujoco>
<worldbody><body><joint name="j"/><geom size="1"/><site/></body></worldbody>
<tendon><fixed><joint joint="j" coef="1"/></fixed></tendon>
<actuator><general joint="j"/></actuator><equality><joint joint1="j"/></equality></mujoco>"""


def unread_fields(model: mujoco.MjModel) -> dict[tuple[str, int], dict[str, Numbers]]:
    """The fields that are neither read, nor without effect, nor at their default.

    Returns
    -------
    dict
        The values by field, for each kind (``jnt``, ``dof``, ``tendon`` …) and number of object.
        Options and flags have the key ``opt``, 0.
    """
    found: dict[tuple[str, int], dict[str, Numbers]] = {}
    for field in fields():
        sort = "opt" if field.startswith(("opt.", "mj")) else field.partition("_")[0]
        for k in range(_count(model, field)) if why_not_unread(field) is None else ():
            value = value_of(model, field, k)
            if value != _default(field, len(value)) and _is_on(model, field, k):
                found.setdefault((sort, k), {})[field] = value
    return found


@cache
def why_not_unread(field: str) -> str | None:
    """The reason why a field is never reported; None for a reported field."""
    if field in READ:
        return "read"
    listed = ((why, name) for why, names in WITHOUT_EFFECT.items() for name in names)
    return next((why for why, name in listed if fnmatchcase(field, name)), None)


@cache
def fields() -> tuple[str, ...]:
    """All fields except counts: the model's, its options' as ``opt.…``, and the flags."""
    model = default_model()
    own = [(name, getattr(model, name)) for name in dir(model) if not name.startswith("_")]
    counts = {name for name, value in own if name.startswith("n") and isinstance(value, int)}
    found = [name for name, value in own if not callable(value) and name not in {"opt"} | counts]
    options = [name for name in dir(model.opt) if not name.startswith("_")]
    return (*found, *(f"opt.{name}" for name in options), *flags())


@cache
def flags() -> dict[str, tuple[str, int]]:
    """Name of a flag → the option that contains it, and its bit."""
    return {
        name: (option, int(bit))
        for kind, option in (("mjtDisableBit", "disableflags"), ("mjtEnableBit", "enableflags"))
        for name, bit in getattr(mujoco, kind).__members__.items()
        if not name.startswith("mjN")  # how many there are
    }


@cache
def default_model() -> mujoco.MjModel:
    """A model with one object of each kind, all at MuJoCo's defaults."""
    return mujoco.MjModel.from_xml_string(ONE_OF_EACH)


def value_of(model: mujoco.MjModel, field: str, k: int = 0) -> Numbers:
    """The numbers of a field of one object; several equal rows count as one."""
    value = _array(model, field)
    if field in COUNTED:
        first, count = (int(getattr(model, name)[k]) for name in COUNTED[field])
        rows = value[first : first + count]
        value = rows[0] if len(rows) and (rows == rows[0]).all() else rows
    elif _per_object(field, value):
        value = value[k]
    return tuple(float(x) for x in np.atleast_1d(value).ravel())


def _array(model: mujoco.MjModel, field: str) -> np.ndarray:
    if field in flags():
        option, bit = flags()[field]
        return np.array(bool(getattr(model.opt, option) & bit))
    option = field.removeprefix("opt.")
    return np.asarray(getattr(model if option == field else model.opt, option))


def _per_object(field: str, value: np.ndarray) -> bool:
    return value.ndim > 0 and not field.startswith("opt.")


def _count(model: mujoco.MjModel, field: str) -> int:
    """Number of objects that have the field."""
    value = _array(model, field)
    return int(model.nactuator) if field in COUNTED else len(value) if value.ndim else 1


@cache
def _default(field: str, size: int) -> Numbers:
    """The value of a field that a file does not state; zeros for an unknown kind of object."""
    known = _count(default_model(), field) > 0
    value = value_of(default_model(), field) if known else ()
    return value * (size // len(value)) if value else (0.0,) * size


def _is_on(model: mujoco.MjModel, field: str, k: int) -> bool:
    """Whether a field is switched on by the field that controls it."""
    switches = SWITCHES.get(field, ())
    return not switches or any(
        any(value_of(model, other, k)) and _is_on(model, other, k) for other in switches
    )
