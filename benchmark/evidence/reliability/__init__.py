"""Reliability campaign: damaged inputs, killed runs. `python -m gof_benchmark.evidence.reliability fuzz|kill --help`; results in docs/reliability.md."""
