"""Blender processes: one generates a dataset stage by stage, one imports a result."""
