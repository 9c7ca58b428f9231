"""Measured radar data: one reader per format, and the way onto a view's slant-plane grid."""
