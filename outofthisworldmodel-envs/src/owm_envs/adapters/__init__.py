"""Stateful shells over the pure environment, one module per ecosystem."""
