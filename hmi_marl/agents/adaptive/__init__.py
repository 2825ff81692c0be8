"""HMIs that infer their driver's traits while driving, and the evidence that they use."""
