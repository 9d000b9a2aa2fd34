"""Sites: access points, frame and georeferenced plan."""
