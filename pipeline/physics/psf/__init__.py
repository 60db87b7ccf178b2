"""Point-spread functions as transfer functions, and the pixel responses made from them."""
