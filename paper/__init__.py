"""The experiments of the paper, flown again: its figures, the baselines, our ablations, and a verdict on each claim.

`make results`, or `ptnsbc reproduce` in a clone, runs them. No package of the product imports this one.
"""
