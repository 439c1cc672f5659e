"""The node that plays a recording to the processing nodes."""
