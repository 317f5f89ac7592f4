"""The watch over a pose in use: false alarms of quiet hearts, and how soon a shift or a drift is found."""
