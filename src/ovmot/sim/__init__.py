"""Simulation with exact truth: trajectories, an IMU, a rendered street."""
