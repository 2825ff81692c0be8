"""Reports: blocks, pages, figures, clips, verdicts and statistics."""
