"""State to image; nothing here is imported unless pixels are asked for."""
