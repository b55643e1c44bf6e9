"""Speed and memory, measured side by side: ``python -m tests.benchmarks [NAME ...]``.

The names are startup, scaling, two_stage, chen, brouri, workers and trials; all of them by default.

Nothing here asserts a time. Times on one machine vary; what is printed to be compared was measured in turns.
"""
