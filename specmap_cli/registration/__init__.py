"""Scan registration: from a stream of sweeps to a stream of posed scans."""
