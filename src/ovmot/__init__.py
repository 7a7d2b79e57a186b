"""ovmot: stereo-inertial odometry and moving-object tracks, without learned models."""

from ovmot.runtime import limit_blas_threads

limit_blas_threads()

__version__ = "0.1.0"
