"""What boards print or answer: a module each, named after the sketch it runs, whose `BOARD` it binds."""
