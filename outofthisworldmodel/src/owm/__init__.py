"""A world model of spacecraft rendezvous: train it, plan with it, dock with it."""

__version__ = "0.1.0"
