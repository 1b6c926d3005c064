"""Thread is pulled through tissue until its tail is as long as asked for (docs/pulling.md)."""
