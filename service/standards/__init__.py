"""Interfaces that others have defined: IVOA UWS, OGC API - Processes."""
