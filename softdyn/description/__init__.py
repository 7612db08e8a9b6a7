"""What a robot's file says, without any engine: joints, inertia, annotations, meshes."""
