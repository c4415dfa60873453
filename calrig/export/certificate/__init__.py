"""A revision's certificate of calibration: what it says, and the forms it is handed out in."""
