"""Panels of the 3D viewport's and the Image editor's sidebars."""
