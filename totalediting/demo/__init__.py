"""`totalediting demo`: editing on a page in the browser."""
