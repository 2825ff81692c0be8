"""The whole reproduction: all experiments, the paper's claims, the report, the release."""
