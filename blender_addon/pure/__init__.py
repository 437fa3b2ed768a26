"""What the add-on knows without Blender: specs, effects, timing, files. Nothing here imports bpy."""
