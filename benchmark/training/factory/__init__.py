"""Fires in seconds: small bakes by the generator, pictures without Cycles, and what the product's stages make of them.

`draws` says what burns, `light` how it shines, `pictures` what cameras make of it; `fire.make_fire` puts them together.
Everything follows from a number, so that a fire need not be kept.
"""
