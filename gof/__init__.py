"""Gaussians on Fire: three videos of a flame to transient 3D Gaussians with real velocities.

Importing `gof` is cheap: heavy libraries (Dr.Jit, torch, OpenCV) are loaded by the module that uses them.
"""

__version__ = "0.2.0"
