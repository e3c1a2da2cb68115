"""The status page, served from within the daemon (extra `web`)."""
