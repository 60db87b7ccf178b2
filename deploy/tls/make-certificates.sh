#!/bin/sh
# Makes a private authority, the certificate that scheduler, workers and service show each other,
# and one for the service's own port. Usage: make-certificates.sh FOLDER [HOST-OR-ADDRESS ...]
# Run it again to renew what the authority signs; the authority itself stays until it is removed.
set -eu

if [ $# -lt 1 ]; then
    echo "usage: $0 FOLDER [HOST ...]" >&2
    exit 2
fi
folder=$1
shift
days=${DAYS:-398}
umask 077
mkdir -p "$folder"

if [ ! -f "$folder/ca.pem" ]; then
    openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 3650 \
        -subj "/CN=Nightglass cluster authority" -addext "basicConstraints=critical,CA:TRUE" \
        -addext "keyUsage=critical,keyCertSign,cRLSign" \
        -keyout "$folder/ca.key" -out "$folder/ca.pem" 2>/dev/null
fi

sign() { # NAME SUBJECT-ALTERNATIVE-NAMES
    openssl req -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -subj "/CN=nightglass-$1" \
        -keyout "$folder/$1.key.new" -out "$folder/$1.csr" 2>/dev/null
    printf 'subjectAltName=%s\nextendedKeyUsage=serverAuth,clientAuth\n' "$2" > "$folder/$1.ext"
    openssl x509 -req -in "$folder/$1.csr" -CA "$folder/ca.pem" -CAkey "$folder/ca.key" \
        -CAcreateserial -days "$days" -extfile "$folder/$1.ext" -out "$folder/$1.pem.new" 2>/dev/null
    mv "$folder/$1.key.new" "$folder/$1.key"
    mv "$folder/$1.pem.new" "$folder/$1.pem"
    rm -f "$folder/$1.csr" "$folder/$1.ext"
}

names="DNS:localhost,IP:127.0.0.1"
for host in "$@"; do
    case $host in
        *:*) kind=IP ;;
        *[!0-9.]*) kind=DNS ;;
        *) kind=IP ;;
    esac
    names="$names,$kind:$host"
done
sign cluster "$names,DNS:scheduler,DNS:nightglass-scheduler"
sign api "$names,DNS:api,DNS:nightglass-api"
echo "$folder: ca.pem, cluster.pem and api.pem with their keys, for $days days"
