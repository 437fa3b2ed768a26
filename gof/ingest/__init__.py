"""From videos to a dataset: frame times, fire-free plates, camera poses, depth."""
