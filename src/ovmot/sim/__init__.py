"""Simulation with exact truth: trajectories, an IMU, rendered streets, features."""
