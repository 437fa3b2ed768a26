"""The computer: optional libraries, progress, child processes, memory, terminal, `gof doctor`."""
