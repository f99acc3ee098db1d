"""The room of lidars: laser scanners whose scans are explained by a grid map."""
