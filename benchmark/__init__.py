"""The benchmark: scene specs, and the studies that show its ground truth is right."""
