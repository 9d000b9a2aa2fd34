"""Range offsets: fitted on source recordings, applied to any."""
