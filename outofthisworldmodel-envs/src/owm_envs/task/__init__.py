"""The docking task: everything but the equations of motion, which it sees only through the relative view."""
