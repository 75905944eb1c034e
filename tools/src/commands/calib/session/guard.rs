//! Who may talk to the session: those who know its address, and no page of another origin.

use std::net::{IpAddr, SocketAddr};

use super::http::{Request, Response};

/// Lets requests through that come from the session's own page.
///
/// Three things stand between another page in the same browser and the session. The address holds a token of 128
/// random bits. The `Host` must be an address, not a name, so that a name that is made to point here (DNS
/// rebinding) does not serve. And browsers say from which origin a request comes: another one is refused.
#[derive(Debug, Clone)]
pub struct Guard {
    token: String,
    address: SocketAddr,
}

impl Guard {
    /// With a fresh token, for the address that is listened on.
    pub fn new(address: SocketAddr) -> Self {
        Self { token: format!("{:032x}", rand::random::<u128>()), address }
    }

    /// The page's address.
    pub fn url(&self) -> String {
        let host = if self.address.ip().is_unspecified() {
            SocketAddr::new(IpAddr::from([127, 0, 0, 1]), self.address.port())
        } else {
            self.address
        };
        format!("http://{host}/{}/", self.token)
    }

    /// What is asked for below the page's address.
    ///
    /// # Errors
    /// The refusal.
    pub fn admit<'r>(&self, request: &'r Request) -> Result<&'r str, Response> {
        let forbidden = |why: &str| Response::text(403, why.to_owned());
        let host = request.header("host").unwrap_or_default();
        if !self.is_own(host) {
            return Err(forbidden("This host name is not the session's; use the address that it printed."));
        }
        if let Some(origin) = request.header("origin")
            && origin.strip_prefix("http://") != Some(host)
        {
            return Err(forbidden("Requests of other origins are refused."));
        }
        if let Some(site) = request.header("sec-fetch-site")
            && !matches!(site, "same-origin" | "none")
        {
            return Err(forbidden("Requests of other sites are refused."));
        }
        let (token, rest) =
            request.path.strip_prefix('/').and_then(|p| p.split_once('/')).unwrap_or_default();
        if !same(token.as_bytes(), self.token.as_bytes()) {
            return Err(forbidden(
                "The token is missing or wrong; use the address that the session printed.",
            ));
        }
        if request.method == "POST" && request.header("content-type") != Some("application/json") {
            return Err(forbidden("Commands are application/json."));
        }
        Ok(rest)
    }

    /// Whether a `Host` is an address that is listened on, or localhost.
    fn is_own(&self, host: &str) -> bool {
        let Some((name, port)) = host.rsplit_once(':') else { return false };
        if port.parse() != Ok(self.address.port()) {
            return false;
        }
        let bare = name.trim_start_matches('[').trim_end_matches(']');
        match bare.parse::<IpAddr>() {
            Ok(ip) => ip == self.address.ip() || self.address.ip().is_unspecified() || ip.is_loopback(),
            Err(_) => name == "localhost",
        }
    }
}

/// Compares without telling by its duration where the first difference is.
fn same(a: &[u8], b: &[u8]) -> bool {
    a.len() == b.len() && a.iter().zip(b).fold(0, |differ, (a, b)| differ | (a ^ b)) == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request(guard: &Guard, change: impl FnOnce(&mut Request)) -> Request {
        let mut request = Request {
            method: "GET".into(),
            path: format!("/{}/state", guard.token),
            headers: vec![("host".into(), "127.0.0.1:4000".into())],
            ..Request::default()
        };
        change(&mut request);
        request
    }

    #[test]
    fn only_the_own_page_is_let_in() {
        let guard = Guard::new("127.0.0.1:4000".parse().expect("an address"));
        assert_eq!(guard.admit(&request(&guard, |_| {})).expect("own"), "state");
        let own = request(&guard, |r| {
            r.headers.push(("origin".into(), "http://127.0.0.1:4000".into()));
            r.headers.push(("sec-fetch-site".into(), "same-origin".into()));
            r.headers.push(("content-type".into(), "application/json".into()));
            r.method = "POST".into();
        });
        assert!(guard.admit(&own).is_ok());
        let refused: [(&str, &dyn Fn(&mut Request)); 8] = [
            ("a wrong token", &|r| r.path = format!("/{:032x}/state", 7)),
            ("no token", &|r| r.path = "/".into()),
            ("a name made to point here", &|r| r.headers[0].1 = "evil.example:4000".into()),
            ("another port", &|r| r.headers[0].1 = "127.0.0.1:80".into()),
            ("no host", &|r| r.headers.clear()),
            ("another origin", &|r| r.headers.push(("origin".into(), "http://evil.example".into()))),
            ("another site", &|r| r.headers.push(("sec-fetch-site".into(), "cross-site".into()))),
            ("a form", &|r| {
                r.method = "POST".into();
                r.headers.push(("content-type".into(), "text/plain".into()));
            }),
        ];
        for (what, change) in refused {
            let answer = guard.admit(&request(&guard, change)).expect_err(what);
            assert_eq!(answer.status, 403, "{what}");
        }
    }
}
