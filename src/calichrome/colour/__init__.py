"""Camera colour to target colour, and how sure that is."""
