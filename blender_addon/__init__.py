"""Gaussians on Fire for Blender: fire scenes with exact ground truth, and reconstructions as animated point clouds.

Runs inside Blender and headless with the ``bpy`` wheel. Needs numpy and nothing else from outside Blender.
"""
