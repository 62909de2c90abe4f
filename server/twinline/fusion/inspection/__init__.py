"""Measuring on clouds and meshes: arrays in, results with uncertainty and the points that they used out."""
