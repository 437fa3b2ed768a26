"""The generator's task graph and the Blender processes it drives."""
