"""A user's own MJCF as the plant: `plant` is the scene, `inputs` how the law's inputs drive it.

`scenery` is what it looks like.
"""
