"""Benchmarks: each prints a table, writes JSON, and compares with a committed baseline."""
