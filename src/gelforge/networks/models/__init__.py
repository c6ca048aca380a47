"""Families of networks, one file each, and what each reads. Needs torch."""
