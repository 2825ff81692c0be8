"""Training runs on the nodes of a Ray cluster, which need not share any folder."""
