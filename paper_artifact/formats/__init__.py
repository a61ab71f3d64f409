"""Mesh files as points and triangles, each format read as its specification says, or refused by name."""
