"""Frames corrected: speed and accuracy beside others, and both kernels beside each other.

Ours is `calichrome.apply.Corrector`; the others are OpenCV in its best and in its usual form,
OpenColorIO, colour-science and numpy.
"""
