"""Complete ways to localize, behind one interface."""
