"""The web page, started by `python app.py`."""
