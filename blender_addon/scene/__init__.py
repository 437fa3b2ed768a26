"""Builders of the Blender scene: fire, camera rig, background, materials, rendering."""
