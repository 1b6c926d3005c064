"""Trains the network of `segmentation/network.py`; for development only, and the only place that imports PyTorch."""
