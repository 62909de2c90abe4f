"""Speed and memory, measured as ratios side by side in one run: what stands in PERFORMANCE.md.

Clocks of machines differ, and so do shared machines from one minute to the next. Every figure here is therefore put
against another one that was measured in turns with it, round by round, on the same core.
"""
