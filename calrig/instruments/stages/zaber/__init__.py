"""Zaber rotary stages."""
