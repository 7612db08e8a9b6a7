"""From a few parameters to a robot's file and meshes."""
