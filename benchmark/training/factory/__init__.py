"""Fires in seconds: a small solver of its own, pictures without Blender, and what the product's stages make of them.

`draws` says what burns, `solver` how its gas moves, `light` how it shines, `pictures` what cameras make of it;
`fire.make_fire` puts them together. Everything follows from a number, so that a fire need not be kept.
"""
