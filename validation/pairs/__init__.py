"""Two files of one robot, and the engines that read them.

`engines` asks Pinocchio and MuJoCo, each for its own file and one against the other, `readers`
what Pinocchio makes of an MJCF, `public_pairs` compares public files and makes tables of them.
"""
