"""Scripts that prove a claim of the docs; README.md lists claim, script, page and duration."""
