"""Indoor localization from WiFi round-trip time and signal strength, with a floor plan as the only prior."""

__version__ = "0.1.0"
