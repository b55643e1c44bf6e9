"""Speed and memory, measured side by side: ``python -m tests.benchmarks [startup scaling workers trials]``.

Nothing here asserts a time. Times on one machine vary; what is printed to be compared was measured in turns.
"""
