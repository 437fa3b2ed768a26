"""Reliability campaign: damaged inputs, killed runs; results in notebook/reliability.md.

python -m tests.reliability fuzz --help
python -m tests.reliability kill --help
"""
