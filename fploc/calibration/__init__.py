"""Range offsets: fitted on source recordings after the split, saved, applied."""
