"""What a calibration can be believed on, as an object for programs and as a page for people."""
