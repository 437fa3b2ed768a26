"""Reliability campaign: damaged inputs, killed runs. `python -m benchmark.reliability fuzz|kill --help`; results in docs/reliability.md."""
