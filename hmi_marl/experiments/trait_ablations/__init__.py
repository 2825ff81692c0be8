"""What the self-supervised encoder owes to its parts: one changed at a time."""
