"""The web page: `python app.py`."""
