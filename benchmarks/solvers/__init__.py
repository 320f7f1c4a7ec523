"""What one would otherwise take: the model for general ODE solvers, and drivers that locate its events."""
