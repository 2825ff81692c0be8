"""Printed values of the paper and their audit by exact values."""
