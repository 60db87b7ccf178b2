"""The sensor as asked for: optics, detector, distortion, cosmic rays."""
