"""File formats of the project; never imports bpy."""
