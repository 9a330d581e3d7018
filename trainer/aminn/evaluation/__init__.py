"""How good a model is: metrics, the comparison with baselines, analyses."""
