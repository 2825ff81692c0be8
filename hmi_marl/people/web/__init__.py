"""Parts that both web services share: pages, texts, cookies, limits and the server."""
