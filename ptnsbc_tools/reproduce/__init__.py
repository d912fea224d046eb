"""`ptnsbc reproduce`: the paper's figures and claims, flown again and judged."""
