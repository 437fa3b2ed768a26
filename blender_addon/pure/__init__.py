"""The add-on's knowledge without Blender: specs, effects, timing, files. Nothing here imports bpy."""
