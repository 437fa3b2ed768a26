"""The capture rig: the LED board and its controller, and the time of every row of every frame read from footage of it."""
