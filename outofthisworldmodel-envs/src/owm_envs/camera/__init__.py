"""State to image, in pure JAX; nothing here is imported unless pixels are asked for."""
