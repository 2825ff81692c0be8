"""Playing episodes, statistics, tables, figures and reports."""
