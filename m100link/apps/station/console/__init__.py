"""The console for browsers. Needs the extra ``station``."""
