"""The optics of a scene: its point-spread function, over the field, and its pupil."""
