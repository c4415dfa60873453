"""What turns a unit in its clamp, by name: a motorised dividing head. Most rigs have none: hands do that."""
