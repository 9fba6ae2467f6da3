"""Masks of the people and things that move before static cameras, without trained weights."""
