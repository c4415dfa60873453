"""HTTP: the API of CONTRACT section 2, events, figures and the page's files. No arithmetic, no SQL."""
