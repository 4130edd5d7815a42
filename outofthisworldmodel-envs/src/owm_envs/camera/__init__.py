"""The camera: light, sky and station as pixels, in pure JAX."""
