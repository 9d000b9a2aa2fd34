"""Every complete way to localize, ours and the rivals', behind one interface."""
