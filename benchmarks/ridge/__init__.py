"""Segmenter `ridge`, by lines and colours without any learning: what the network is compared with."""
