"""Reliability campaign: damaged inputs, killed runs; results in docs/reliability.md.

python -m gof_benchmark.evidence.reliability fuzz --help
python -m gof_benchmark.evidence.reliability kill --help
"""
