"""Where the camera looks, and where stars, lamps and the Earth stand in each exposure."""
