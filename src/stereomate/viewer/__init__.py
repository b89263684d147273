"""The web page, its tiles and its server."""
