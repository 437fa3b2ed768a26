"""Public Gaussian-splatting research code, unmodified, on a CPU instead of CUDA.

Another method's script has its own process, `python -m gof.on_cpu --method NAME SCRIPT ARGS...`, which `gof baseline`
starts. Before the script begins, stand-ins for the compiled modules that it imports are put into `sys.modules`, and
PyTorch takes "cuda" for "cpu". Both are global, so nothing in `gof` imports this room. Everything is drawn
by `gof.render.rasterize`. docs/baselines.md names the commits and settings that this was made for.
"""
