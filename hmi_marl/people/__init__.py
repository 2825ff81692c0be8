"""People in either seat: trips in the browser, their data, and traits measured from play."""
