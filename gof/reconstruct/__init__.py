"""From three videos to transient flame Gaussians: motion -> voxels -> flow field -> seeds -> optimisation."""
