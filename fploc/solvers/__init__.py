"""One-shot geometry: ranges of one interval in, a position with its covariance out."""
