"""The scene that does not move: footage -> plates, poses, dataset; stereo depth and a Gaussian background on request."""
