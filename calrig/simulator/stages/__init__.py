"""What stages' controllers say and allow: a module each, named after the driver, whose `STAGE` it binds."""
