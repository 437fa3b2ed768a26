"""Files of other programs, with numpy and the standard library only: nothing here imports bpy."""
