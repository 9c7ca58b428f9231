"""What models declare (`model.py`), and the parameters that several share (`parameters.py`)."""
