"""One self-contained HTML page that plays a flame anywhere: its data here, its JavaScript and shaders beside it."""
