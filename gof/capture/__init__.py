"""The capture rig. Board: the LED board in the pictures. Target: the ChArUco pattern that cameras are calibrated with.

The board's geometry is `template`, the device on the serial port `controller` and `protocol`. Footage of it becomes
frame times in this order: `locate`, `signals`, `strips` (fine clock) and `counter` (coarse clock), `clock` (the
camera's own), `decode` (all of one camera), `sync` (all cameras, `times`).
"""
