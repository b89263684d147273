"""Synthetic surveys: worlds with known truth, photographed rigorously."""
