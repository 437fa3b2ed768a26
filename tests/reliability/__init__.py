"""Reliability campaign: damaged inputs, killed runs; results in docs/reliability.md.

python -m tests.reliability fuzz --help
python -m tests.reliability kill --help
"""
