"""The MuJoCo plant, built from the URDF by its own path."""
