"""OpenFOAM's fireFoam (large-eddy simulation of a diffusion flame) as a source of fires."""
