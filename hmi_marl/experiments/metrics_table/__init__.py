"""Tables of HMIs and drivers; the paper's table of metrics made again."""
